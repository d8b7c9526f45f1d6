"""What the demos are compared with, and lists of cases."""
