"""Training: choice and solution of training queries, and models built from them."""
