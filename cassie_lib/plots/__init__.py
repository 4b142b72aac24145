"""One module of figures per notebook."""
