"""Bounds of errors, evaluated; what they need is made in certify and reduction."""
