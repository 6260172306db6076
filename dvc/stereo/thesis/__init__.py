"""Tables 2.1 to 2.3 and figures 2.2 and 2.4 to 2.11 of the thesis, measured and drawn again."""
