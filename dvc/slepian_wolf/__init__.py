"""Slepian-Wolf coding of bit planes: turbo codes and Cascade; usable on its own."""

from dvc.config import CascadeConfig, CodecConfig, TurboConfig
from dvc.extensions import PLANE_CODERS, make
from dvc.slepian_wolf.cascade.cascade_coder import CascadeCoder
from dvc.slepian_wolf.checks import (
    CRC_BITS as CRC_BITS,
    crc as crc,
    crc_words as crc_words,
    joint_check as joint_check,
)
from dvc.slepian_wolf.coupling import NeighbourCoupling as NeighbourCoupling
from dvc.slepian_wolf.plane_protocol import (
    FrameCheck as FrameCheck,
    PlaneCoder as PlaneCoder,
    PlaneCost as PlaneCost,
    PlaneDecoder as PlaneDecoder,
    PlaneResult as PlaneResult,
)
from dvc.slepian_wolf.requests import (
    KINDS as KINDS,
    MAX_RUN_BITS as MAX_RUN_BITS,
    Answer as Answer,
    Kind as Kind,
    ParityRequest as ParityRequest,
    Part as Part,
    Place as Place,
    RequestTable as RequestTable,
    Round as Round,
    Run as Run,
    ask as ask,
    beginning as beginning,
    drive as drive,
    side_by_side as side_by_side,
)
from dvc.slepian_wolf.turbo.turbo_coder import TurboCoder


def plane_coder(config: CodecConfig) -> PlaneCoder:
    """Return the coder of planes of a configuration.

    Parameters
    ----------
    config : CodecConfig
        Its section `coder` holds the settings.

    Returns
    -------
    PlaneCoder
        The coder.
    """
    if isinstance(config.coder, CascadeConfig):
        return CascadeCoder(config.coder, config.seed)
    if isinstance(config.coder, TurboConfig):
        return TurboCoder(config.seed)
    coder: PlaneCoder = make(PLANE_CODERS, config.coder.name, config.seed)
    return coder
