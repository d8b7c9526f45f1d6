"""A model as one page that answers in a browser, without Python and without a network."""
