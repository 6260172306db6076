"""The process in which groups of pictures are decoded: `decoder.parallel` starts it and talks to it.

Tasks come through the connection whose file descriptor is the only argument. The answer is the decoded
group, or the exception that it ended with; before that come requests for parity, if the encoder is live.
"""

import os
import signal
import sys
from multiprocessing.connection import Connection
from typing import Any

from decoder.tasks import GroupTask, naming_group
from dvc.config import decode_config


def serve(connection: "Connection[Any, Any]") -> None:
    """Decode groups until nobody wants any.

    Parameters
    ----------
    connection : Connection
        The other end of that of a `DecodingProcess`.
    """

    def _ask(request: object) -> Any:
        connection.send(request)
        return connection.recv()

    _import_opencv_quietly()
    from decoder.group import GroupDecoder

    decoders: dict[bytes, GroupDecoder] = {}
    while True:
        try:
            task: GroupTask = connection.recv()
            if task.config not in decoders:
                decoders.clear()
            try:
                if task.config not in decoders:
                    decoders[task.config] = GroupDecoder(decode_config(task.config))
                with naming_group(task.number):
                    connection.send(decoders[task.config].decode(task, _ask))
            except Exception as err:
                connection.send(err)
        except (EOFError, OSError):
            return


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
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who started this process ends it
    serve(Connection(int(sys.argv[1])))
