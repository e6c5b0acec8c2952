"""Source of a shape: its file and how that was read, which all derived files record."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Source:
    """File of a tree's shape, and its conversion to metres and +Z up."""

    sha256: str = ""  # hash of the file's bytes; empty if unknown
    up_axis: str = ""  # axis of the file, such as "+Y"; empty if its axes and units are unknown; see `up_axis.py`
    up_confidence: float = 1.0  # confidence in [0, 1]; below 1 the axis was detected from the shape
    scale: float = 1.0  # metres per unit of the file
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)  # subtracted from its coordinates, in its axes and unit

    @property
    def extras(self) -> dict[str, object]:
        """Metadata for written files: the source's offset, if it has one."""
        return {"source_offset": list(self.offset)} if any(self.offset) else {}


UNKNOWN = Source()
METRES_Z_UP = Source(up_axis="+Z")
