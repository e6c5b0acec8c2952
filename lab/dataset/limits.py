"""Limits on a tree's motion for the dataset. Paper appendix A, step 2. Imports only pydantic."""

from pydantic import Field

from dynamictree.request_model import Finite, Request


class DatasetLimits(Request):
    """Largest accepted values of a training tree's motion."""

    above_hz: Finite = Field(default=3.0, gt=0, description="Frequencies above this count as high [Hz]")
    high_frequency: Finite = Field(
        default=0.001, ge=0, le=1, description="Reject where more than this share of the energy is of high frequencies"
    )
    root_motion: Finite = Field(
        default=0.001, ge=0, le=1, description="Reject where roots move more than this share of the height"
    )
    edge_stretch: Finite = Field(
        default=0.02,
        ge=0,
        le=10,
        description="Reject where more than one edge in a thousand stretches by more than this share",
    )
    self_explosion: Finite = Field(
        default=0.5, ge=0, le=10, description="Reject where a vertex moves more than this share of the height"
    )
