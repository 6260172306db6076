"""What a report rests on: how many points, of when, made by which versions of the code."""

from collections.abc import Sequence

from dvc.rd.anchors.codecs import ANCHOR_CODECS
from dvc.rd.markdown import escaped
from dvc.rd.reference_rows import REFERENCE_LABELS
from dvc.rd.results import PointResult


def preface(results: Sequence[PointResult]) -> str:
    """Say what a report rests on.

    Parameters
    ----------
    results : sequence of PointResult
        What was measured.

    Returns
    -------
    str
        Number of points, dates, versions of the code with a warning if there are several, what a rate is.
    """
    return (
        f"{measured_text(results)} "
        "Rates of distributed codecs are sizes of punctured streams, each decoded to the same frames "
        "by a fresh process, rates of others are sizes of whole files; PSNRs are of luma, means of frames.\n"
    )


def measured_text(results: Sequence[PointResult]) -> str:
    """Say what was measured, when, and by which code.

    Parameters
    ----------
    results : sequence of PointResult
        Points; those that were read from a table of the reference software do not count.

    Returns
    -------
    str
        One or two sentences.
    """
    results = [r for r in results if r.data["codec"] not in REFERENCE_LABELS]
    codes = sorted(
        {(r.data["code"]["version"], r.data["code"].get("commit") or "no commit") for r in results}
    )
    digests = code_digests(results)
    dates = sorted(str(r.data.get("date", ""))[:10] for r in results)
    code = escaped(", ".join(f"dvc3d {version} ({commit})" for version, commit in codes))
    mixed = f" The points come from {len(digests)} versions of the code." if len(digests) > 1 else ""
    period = dates[0] if dates[0] == dates[-1] else f"{dates[0]} to {dates[-1]}"
    return f"{len(results)} points, measured {period} with {code}.{mixed}"


def code_digests(results: Sequence[PointResult]) -> set[str]:
    """Return the versions of the code that made points of the project's own codecs.

    Parameters
    ----------
    results : sequence of PointResult
        What was measured.

    Returns
    -------
    set of str
        Digests; there should be one.
    """
    others = {*ANCHOR_CODECS, *REFERENCE_LABELS}
    return {result.data["code"]["digest"] for result in results if result.data["codec"] not in others}
