"""Full-order answers and histories, for training and held out, computed and stored on disk."""
