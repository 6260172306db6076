"""Subcommands of `dvc-stereo`: each module has `add_parser`, and `run` that takes the arguments."""
