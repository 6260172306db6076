"""All coders of planes that a decoder asks, by their configuration."""

from dvc.config import CascadeConfig, CodecConfig, TurboConfig
from dvc.extensions import PLANE_CODERS, make
from dvc.slepian_wolf.cascade.cascade_coder import CascadeCoder
from dvc.slepian_wolf.plane_protocol import PlaneCoder
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
