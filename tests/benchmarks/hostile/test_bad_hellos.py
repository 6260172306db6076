"""Bad hellos: all of them are sent, each is rejected, and the good decoder gets its frames."""

import re
from pathlib import Path

import pytest

from benchmarks.hostile import bad_hellos
from benchmarks.hostile.bad_hellos import HELLOS, send_hellos
from benchmarks.hostile.lost_links import certificate
from benchmarks.loopback import accepting
from dvc.config import VideoConfig, codec_config
from dvc.feedback import Protection
from dvc.feedback.protection import encoder_context
from encoder import acceptor
from tests.clips import moving_texture, write_clip
from tests.waiting import wait_until

CONFIG = codec_config(VideoConfig(32, 24, 25, 1, luma_only=True), "2d")


def test_every_hello_is_sent_and_rejected(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(bad_hellos, "SILENT_EVERY", len(HELLOS))
    monkeypatch.setattr(acceptor, "MAX_LINES", 4 * len(HELLOS))
    (_, chain), _ = certificate(tmp_path)
    assert isinstance(chain, Path)
    lines: list[str] = []
    protection = Protection(encoder_context(chain), b"a token of some length")
    with accepting(CONFIG, 5.0, 5.0, protection, lines) as (listener, _):
        address = listener.host, listener.port
        sent = send_hellos(address, 2 * len(HELLOS), 0.0, 1)
        wait_until(lambda: len(lines) >= 2 * len(HELLOS))
    assert sum(send_hellos(address, 5, 0.0, 1).values()) == 0  # the port is closed
    assert sent == dict.fromkeys(list(HELLOS)[:-1], 2) | {list(HELLOS)[-1]: 0, "silence": 2}
    assert all(line.startswith("not a decoder: ") for line in lines)


@pytest.mark.slow
def test_a_good_decoder_notices_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    clip = write_clip(tmp_path / "clip.y4m", moving_texture(6, 48, 64))
    words = ["--clip", clip, "--frames", 12, "--count", 20, "--pairs", 1, "--codec", "2d", "--out", tmp_path]
    assert bad_hellos.main([*map(str, words)]) == 0
    line = capsys.readouterr().out.splitlines()[-1]
    ratio = r"\d+\.\d+"
    assert re.fullmatch(
        f"same frames and bits: yes; median ratio wall {ratio}, processor {ratio}, coding {ratio}", line
    )
