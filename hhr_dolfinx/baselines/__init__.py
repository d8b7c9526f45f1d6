"""Other ways to answer the same question, each with the same calls as a reduced model."""
