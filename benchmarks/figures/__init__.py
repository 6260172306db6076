"""Every figure that is asked of the project, and how it is measured."""
