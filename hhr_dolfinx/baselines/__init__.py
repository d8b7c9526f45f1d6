"""Other models that answer the same question, to compare with."""
