"""Accuracy of answers: residuals and errors, stability constants, the check of a reduced model."""
