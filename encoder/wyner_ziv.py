"""Wyner-Ziv side of the encoder: transform, quantiser, bit planes and their parity."""

from dvc import turbo
from dvc.config import CodecConfig
from dvc.video import Frame
from dvc.wynerziv import quantizer, transform
from dvc.wynerziv.answers import OpenFrames
from dvc.wynerziv.buffered import EncodedFrame, transform_frame
from dvc.wynerziv.layout import FrameLayout


class WynerZivEncoder:
    """Encodes Wyner-Ziv frames of one configuration.

    Parameters
    ----------
    config : CodecConfig
        Configuration of the stream.
    lazily : bool, optional
        Leave bit planes until it is known which are wanted: meanwhile a frame takes more memory.
    """

    def __init__(self, config: CodecConfig, *, lazily: bool = False) -> None:
        self._layout = FrameLayout.of(config)
        self._lazily = lazily
        self._encoders = turbo.parity_encoders(config.turbo.family, config.turbo.interleaver_seed)

    def encode(self, frame: Frame, step: float = 1.0) -> EncodedFrame:
        """Encode one frame; parity is computed when it is asked for.

        Parameters
        ----------
        frame : Frame
            Original samples, of which luma is coded.
        step : float, optional
            Width of nested bins, which is rounded up to one that can be told.

        Returns
        -------
        EncodedFrame
            All bits that a decoder may ask for.
        """
        quantization, packing = transform_frame(self._layout, frame.luma, quantizer.index_of_step(step))
        encoded = EncodedFrame(self._layout, quantization, packing, self._encoders)
        if not self._lazily:
            encoded.pack(transform.NUM_BANDS)
        return encoded

    def open_frames(self, num_slots: int) -> OpenFrames:
        """Return what answers requests for frames of this configuration.

        Parameters
        ----------
        num_slots : int
            Frames that may be open at a time.

        Returns
        -------
        OpenFrames
            Without any frame.
        """
        return OpenFrames(self._layout, self._encoders, num_slots)
