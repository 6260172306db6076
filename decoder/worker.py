"""The process in which groups of pictures are decoded: `decoder.parallel` starts it and talks to it.

Tasks come through the connection whose file descriptor is the only argument. The answer is the decoded
group, or the exception that it ended with; before that come requests for parity, if the encoder is live.
"""

import os
import sys
import traceback
from multiprocessing.connection import Connection
from queue import SimpleQueue
from threading import Thread
from typing import Any

from decoder.tasks import GroupTask, naming_group
from dvc.config import decode_config
from dvc.errors import DvcError


def serve(connection: "Connection[Any, Any]") -> None:
    """Decode groups until nobody wants any.

    Parameters
    ----------
    connection : Connection
        The other end of that of a `DecodingProcess`.
    """
    received: SimpleQueue[Any] = SimpleQueue()
    Thread(target=_receive, args=(connection, received), daemon=True).start()

    def _ask(request: object) -> Any:
        connection.send(request)
        return received.get()

    _import_opencv_quietly()
    from decoder.group import GroupDecoder

    decoders: dict[bytes, GroupDecoder] = {}
    while True:
        task: GroupTask = received.get()
        try:
            if task.config not in decoders:
                decoders = {task.config: GroupDecoder(decode_config(task.config))}
            with naming_group(task.number):
                outcome: object = decoders[task.config].decode(task, _ask)
        except DvcError as err:
            outcome = err
        except Exception as err:  # whose class the other side may be unable to read
            outcome = RuntimeError(repr(err))
            outcome.add_note(f"in the decoding process:\n{traceback.format_exc()}")
        connection.send(outcome)


def _receive(connection: "Connection[Any, Any]", received: "SimpleQueue[Any]") -> None:
    """Take what comes; end the process, whatever it does, where nobody is left who wants it."""
    try:
        while True:
            received.put(connection.recv())
    except (EOFError, OSError):
        os._exit(0)


def _import_opencv_quietly() -> None:
    """Keep from standard error which features, of those that OpenCV must not use, are not there anyway."""
    kept = os.dup(2)
    with open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), 2)
    try:
        import cv2  # noqa: F401
    finally:
        os.dup2(kept, 2)
        os.close(kept)


if __name__ == "__main__":
    serve(Connection(int(sys.argv[1])))
