"""Command `dvc-dibr`: subcommands, as `dvc.subcommands` takes them."""
