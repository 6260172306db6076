"""Subcommands of `dvc-dibr`: modules as `dvc.subcommands` takes them."""
