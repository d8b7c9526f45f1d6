"""Evaluation of error bounds; their arrays are computed in certify and reduction."""
