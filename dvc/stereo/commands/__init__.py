"""Subcommands of `dvc-stereo`: modules as `dvc.subcommands` takes them."""
