"""What is open on the feedback channel (groups of pictures, credits, requests), as both ends see it.

All methods raise `ValueError` for a step that the protocol does not allow: a mistake of the caller if the
step is its own, a breach of the protocol if it is the peer's.
"""

from dataclasses import dataclass, field
from itertools import pairwise

from dvc.config import CodecConfig
from dvc.turbo import CASCADE, KINDS, ParityRequest, num_codes

MAX_OPEN_GOPS = 16
"""Most groups of pictures that are sent or promised and not done, so that both ends need bounded memory."""


@dataclass
class _Plane:
    """Requests for one bit plane so far."""

    code: int | None = None  # known from the first request for check bits or parity
    num_requested: dict[str, int] = field(default_factory=lambda: dict.fromkeys(KINDS, 0))
    num_awaited: int = 0  # bits of the request that is not answered yet


@dataclass
class _OpenGop:
    first_frame: int
    num_wyner_ziv: int
    planes: dict[tuple[int, int], _Plane] = field(default_factory=dict)


class Ledger:
    """Accounts for groups of pictures and requests, and says what may not be.

    Parameters
    ----------
    config : CodecConfig
        Bounds the numbers of frames, planes, codes and bits.
    """

    def __init__(self, config: CodecConfig) -> None:
        self.num_credits = 0  # groups of pictures that may be sent
        self.num_frames = 0  # of all groups of pictures sent
        self.ended = False
        self._gop_length = config.gop.length
        self._has_anchors = config.gop.anchor_distance > 0
        self._num_planes = sum(config.wyner_ziv.max_planes)
        self._num_codes = num_codes(config.turbo.family)
        self._by_positions = config.turbo.family == CASCADE
        self._limits = {
            "crc": config.turbo.crc_bits,
            "parity": config.video.num_blocks,
            "uncoded": config.video.num_blocks,
            "joint": self._num_planes * config.turbo.crc_bits if self._by_positions else 0,
        }
        self._num_gops = 0
        self._open: dict[int, _OpenGop] = {}

    @property
    def num_gops(self) -> int:
        """Number of groups of pictures sent so far."""
        return self._num_gops

    @property
    def finished(self) -> bool:
        """Whether the end was announced and all groups of pictures are done."""
        return self.ended and not self._open

    def add_credit(self) -> None:
        """Allow one more group of pictures.

        Raises
        ------
        ValueError
            If too many are open or promised.
        """
        if len(self._open) + self.num_credits >= MAX_OPEN_GOPS:
            raise ValueError(f"more than {MAX_OPEN_GOPS} groups of pictures open")
        self.num_credits += 1

    def open_gop(self, number: int, num_frames: int, without_key: bool = False) -> None:
        """Enter a group of pictures.

        Parameters
        ----------
        number : int
            Its number, from 0, in order.
        num_frames : int
            Frames that it adds.
        without_key : bool, optional
            Whether the last of them is a Wyner-Ziv frame, too.

        Raises
        ------
        ValueError
            If it was not asked for, is not the next, has too many frames, or must have a key frame.
        """
        if self.ended:
            raise ValueError("a group of pictures after the end")
        if self.num_credits == 0:
            raise ValueError("a group of pictures that was not asked for")
        if number != self._num_gops:
            raise ValueError(f"group of pictures {number} where {self._num_gops} is the next")
        limit = self._gop_length if number else 1
        if num_frames > limit:
            raise ValueError(
                f"{num_frames} frames in group of pictures {number}, at most {limit} are allowed"
            )
        if without_key and not (number and self._has_anchors):
            raise ValueError(f"group of pictures {number} has no key frame")
        self._open[number] = _OpenGop(self.num_frames, num_frames - (not without_key))
        self.num_credits -= 1
        self._num_gops += 1
        self.num_frames += num_frames

    def request(self, request: ParityRequest) -> None:
        """Enter a request.

        Parameters
        ----------
        request : ParityRequest
            For a plane without a request that waits for its answer.

        Raises
        ------
        ValueError
            If no such bits can be asked for now.
        """
        gop = self._find(request.frame, request.plane)
        plane = gop.planes.get((request.frame, request.plane), _Plane())
        where = f"plane {request.plane} of frame {request.frame}"
        if plane.num_awaited:
            raise ValueError(f"a second request for {where} before the answer to the first")
        if request.start != plane.num_requested[request.kind]:
            raise ValueError(
                f"{request.kind} bits of {where} from number {request.start} on, "
                f"where {plane.num_requested[request.kind]} is the next"
            )
        if not 1 <= request.count <= self._limits[request.kind] - request.start:
            raise ValueError(f"{request.count} {request.kind} bits of {where} from number {request.start} on")
        self._check_code(request, plane, where)
        self._check_positions(request, where)
        plane.num_requested[request.kind] += request.count
        plane.num_awaited = request.count
        gop.planes[request.frame, request.plane] = plane

    def _check_code(self, request: ParityRequest, plane: _Plane, where: str) -> None:
        if request.kind == "uncoded":
            return
        other = not self._by_positions and plane.code not in (None, request.code)
        if other or not 0 <= request.code < self._num_codes:
            raise ValueError(f"code {request.code} for {where}")
        plane.code = request.code

    def _check_positions(self, request: ParityRequest, where: str) -> None:
        """Check that positions are given where, and only where, bits have no order of release."""
        positions, limit = request.positions, 0
        if request.kind == "joint":
            limit = self._num_planes
            if request.count > self._limits["crc"]:
                raise ValueError(f"{request.count} joint bits of {where} at once")
            if positions[:1] != (request.plane,):
                raise ValueError(f"joint bits of other planes than {where}")
        elif self._by_positions and request.kind == "parity":
            limit = self._limits["parity"] * (self._num_codes - request.code)
            if len(positions) != request.count:
                raise ValueError(f"{request.count} parity bits of {where} at {len(positions)} positions")
        if positions and not limit:
            raise ValueError(f"positions of {request.kind} bits of {where}")
        if positions and (positions[-1] >= limit or any(a >= b for a, b in pairwise((-1, *positions)))):
            raise ValueError(
                f"positions of {request.kind} bits of {where} must increase from 0 to {limit - 1}"
            )

    def answer(self, frame: int, plane: int, count: int) -> None:
        """Enter the answer to a request.

        Parameters
        ----------
        frame, plane : int
            As in the request.
        count : int
            Number of bits.

        Raises
        ------
        ValueError
            If nothing was asked for, or not so many bits.
        """
        state = self._find(frame, plane).planes.get((frame, plane))
        if state is None or not state.num_awaited:
            raise ValueError(f"bits of plane {plane} of frame {frame} that were not asked for")
        if count != state.num_awaited:
            raise ValueError(f"{count} bits of plane {plane} of frame {frame}, asked for {state.num_awaited}")
        state.num_awaited = 0

    def close_gop(self, number: int) -> None:
        """Strike out a group of pictures.

        Parameters
        ----------
        number : int
            Its number.

        Raises
        ------
        ValueError
            If it is not open, or answers are missing.
        """
        if number not in self._open:
            raise ValueError(f"group of pictures {number} is not open")
        if any(plane.num_awaited for plane in self._open[number].planes.values()):
            raise ValueError(f"group of pictures {number} is done before all its requests are answered")
        del self._open[number]

    def end(self, num_frames: int) -> None:
        """Enter the end of the sequence.

        Parameters
        ----------
        num_frames : int
            Frames of all groups of pictures.

        Raises
        ------
        ValueError
            If it ended before, or another number of frames was sent.
        """
        if self.ended:
            raise ValueError("a second end")
        if num_frames != self.num_frames:
            raise ValueError(f"end after {num_frames} frames, but {self.num_frames} were sent")
        self.ended = True

    def _find(self, frame: int, plane: int) -> _OpenGop:
        if not 0 <= plane < self._num_planes:
            raise ValueError(f"plane {plane}, there are {self._num_planes}")
        for gop in self._open.values():
            if gop.first_frame <= frame < gop.first_frame + gop.num_wyner_ziv:
                return gop
        raise ValueError(f"frame {frame} is no Wyner-Ziv frame of an open group of pictures")
