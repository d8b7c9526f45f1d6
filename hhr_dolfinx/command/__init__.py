"""The command ``hhr``: all functions of the package for a scene in a file, without a user's
program.
"""
