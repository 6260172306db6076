"""Anchors: standard codecs on the same frames, as real files that FFmpeg decodes; see `docs/anchors.md`."""
