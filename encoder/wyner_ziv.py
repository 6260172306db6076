"""Wyner-Ziv side of the encoder: transform, quantiser, bit planes and their parity."""

from dvc import turbo
from dvc.config import CodecConfig
from dvc.video import Frame
from dvc.wynerziv.buffered import EncodedFrame, quantize_frame
from dvc.wynerziv.layout import FrameLayout


class WynerZivEncoder:
    """Encodes Wyner-Ziv frames of one configuration.

    Parameters
    ----------
    config : CodecConfig
        Configuration of the stream.
    """

    def __init__(self, config: CodecConfig) -> None:
        self._layout = FrameLayout.of(config)
        self._codes = turbo.family(config.turbo.family)
        self._seed = config.turbo.interleaver_seed

    def encode(self, frame: Frame) -> EncodedFrame:
        """Encode one frame; parity is computed when it is asked for.

        Parameters
        ----------
        frame : Frame
            Original samples, of which luma is coded.

        Returns
        -------
        EncodedFrame
            All bits that a decoder may ask for.
        """
        steps, words = quantize_frame(self._layout, frame.luma)
        header = self._layout.write_header(steps)
        return EncodedFrame(self._layout, header, words, self._codes, self._seed)
