"""The thesis, measured again: each of its numbers beside its method as written and beside ours."""
