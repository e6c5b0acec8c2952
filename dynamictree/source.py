"""What a shape was read from, and how: the files that are made of it record this."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Source:
    """A file of a tree's shape, and how its axes and units became metres and +Z up."""

    sha256: str = ""  # of the file's bytes; empty where it is not known
    up_axis: str = ""  # of the file, such as "+Y"; empty where nothing is known of axes and units; see `up_axis.py`
    up_confidence: float = 1.0  # in [0, 1]; below 1 the axis was found from the shape
    scale: float = 1.0  # metres in a unit of the file
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)  # subtracted from its coordinates, in its axes and unit

    @property
    def extras(self) -> dict[str, object]:
        """What a file in metres says of where the source was."""
        return {"source_offset": list(self.offset)} if any(self.offset) else {}


UNKNOWN = Source()
METRES_Z_UP = Source(up_axis="+Z")
