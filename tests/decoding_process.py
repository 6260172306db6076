"""Decodes as it is told, a line at a time: a process whose libraries load once for many streams.

Takes arguments of `dvc-decode` as JSON lists from its standard input, and answers each with a list of these
arguments, the exit status and what went to standard error.
"""

import io
import json
import sys
from contextlib import redirect_stderr

import decoder.__main__ as decoder

for line in sys.stdin:
    arguments = json.loads(line)
    with redirect_stderr(io.StringIO()) as said:
        status = decoder.main(arguments)
    sys.stdout.write(json.dumps([arguments, status, said.getvalue()]) + "\n")
    sys.stdout.flush()
