"""Contracts of extensions as tests that authors run on their classes: ``pytest --pyargs dvc.contracts``."""
