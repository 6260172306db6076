"""Bad hellos: all of them are sent, each is turned away, and the good decoder gets its frames."""

import re
from pathlib import Path

import pytest
from encoder.door import Door

from benchmarks.hostile import bad_hellos
from benchmarks.hostile.bad_hellos import HELLOS, send_hellos
from dvc.config import VideoConfig, codec_config
from dvc.feedback import Protection, listen
from encoder import door
from tests.clips import moving_texture, write_clip
from tests.waiting import wait_until

CONFIG = codec_config(VideoConfig(32, 24, 25, 1, luma_only=True), "2d")


def test_every_hello_is_sent_and_turned_away(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also one that never ends; the door says so of each."""
    monkeypatch.setattr(bad_hellos, "SILENT_EVERY", len(HELLOS))
    monkeypatch.setattr(door, "MAX_TOLD", 2 * len(HELLOS))
    said: list[str] = []
    with listen("127.0.0.1") as listener:
        with Door(listener, CONFIG, Protection(True, b"a token of some length"), 5.0, 5.0, said.append):
            sent = send_hellos((listener.host, listener.port), 2 * len(HELLOS), 0.0, 1)
            wait_until(lambda: len(said) == 2 * len(HELLOS))
        assert sum(send_hellos(("127.0.0.1", listener.port), 5, 0.0, 1).values()) == 0  # nobody listens
    assert sent == dict.fromkeys(list(HELLOS)[:-1], 2) | {list(HELLOS)[-1]: 0, "silence": 2}
    assert all(line.startswith("not a decoder: ") for line in said)


@pytest.mark.slow
def test_a_good_decoder_notices_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It gets the same frames; what that takes is told."""
    clip = write_clip(tmp_path / "clip.y4m", moving_texture(6, 48, 64))
    words = ["--clip", clip, "--frames", 12, "--count", 20, "--pairs", 1, "--codec", "2d", "--out", tmp_path]
    assert bad_hellos.main([*map(str, words)]) == 0
    told = capsys.readouterr().out.splitlines()[-1]
    ratio = r"\d+\.\d+"
    assert re.fullmatch(
        f"same frames and bits: yes; median ratio wall {ratio}, processor {ratio}, coding {ratio}", told
    )
