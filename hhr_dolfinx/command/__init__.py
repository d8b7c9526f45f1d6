"""The command ``hhr``: everything that the package does for a scene in a file, without a program around it."""
