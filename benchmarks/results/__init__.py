"""The headline results: what each is, how it is measured, which code it is of, and where it is shown."""
