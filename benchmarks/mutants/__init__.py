"""How many small changes of the packages their tests notice: `python -m benchmarks.mutants`."""
