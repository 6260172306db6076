"""Subcommands of `dvc-dibr`, as `dvc.subcommands` takes them."""
