"""What a reduced model needs after it is built: a file to live in, and tables of parameters to answer."""
