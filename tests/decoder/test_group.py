"""Groups of pictures decoded in memory."""

import pytest

from decoder.group import GroupDecoder
from dvc.config import VideoConfig, codec_config
from dvc.errors import BitstreamError


def test_unknown_methods_are_refused() -> None:
    """A stream that names a method of the future is refused by name."""
    config = codec_config(VideoConfig(16, 16, 25, 1), side_information={"method": "magic"})
    with pytest.raises(BitstreamError, match="'magic' is not installed; there are mci"):
        GroupDecoder(config)
