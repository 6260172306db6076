"""What is loaded once, before decoding processes are forked from it."""

from benchmarks.hostile import attempts, workers

KINDS = attempts.kinds()
workers.load_kernels()
