"""How far an answer can be trusted: residuals and errors, stability constants, the check of a reduced model."""
