"""Coders of planes by name, for tests that do without a configuration."""

from dvc.config import CascadeConfig
from dvc.slepian_wolf import PlaneCoder
from dvc.slepian_wolf.cascade.cascade_coder import CascadeCoder
from dvc.slepian_wolf.turbo.turbo_coder import TurboCoder

SEED = 1


def coder_of(name: str, settings: CascadeConfig | None = None) -> PlaneCoder:
    """Return a coder; settings are those of Cascade."""
    return TurboCoder(SEED) if name == "turbo" else CascadeCoder(settings or CascadeConfig(), SEED)
