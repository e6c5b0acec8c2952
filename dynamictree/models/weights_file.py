"""Trained weights in a safetensors file; its metadata record the network and how it was trained."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from pydantic import TypeAdapter, ValidationError
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from dynamictree.errors import CheckpointError

MAX_EXACT = 48
"""Largest tensor that is stored as float32: scales of frequencies go down to 1e-6, where float16 has few digits."""


class StorableNetwork(nn.Module):
    """Network that its preset, a dataclass, describes completely."""

    KIND: ClassVar[str]  # format name in the weights file
    VERSION: ClassVar[str]
    PRESET: ClassVar[type]

    def __init__(self, preset: Any) -> None:
        super().__init__()
        self.preset = preset


Network = TypeVar("Network", bound=StorableNetwork)


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """Origin of weights; unknown values are None."""

    step: int | None = None
    data_sha256: str | None = None  # hash of the training shards, see `dataset.shards.shards_sha256`
    card: str | None = None  # Markdown


@dataclass(frozen=True, kw_only=True, eq=False)
class WeightsFile:
    """Content of a weights file."""

    kind: str  # format name, `dynamictree-small` or `dynamictree-paper`
    version: str
    preset: dict[str, object]
    tensors: dict[str, Tensor]
    provenance: Provenance = field(default_factory=Provenance)

    def network(self, kind: type[Network], name: str) -> Network:
        """Build the network with its weights; `name` is for error messages.

        Raises:
            CheckpointError: the preset or the tensors do not fit the network.
        """
        try:
            network = kind(TypeAdapter(kind.PRESET).validate_python(self.preset))
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(map(str, first["loc"]))
            raise CheckpointError(f"{name} has a preset that cannot be read: {where}: {first['msg']}") from error
        try:
            network.load_state_dict(self.tensors)
        except RuntimeError as error:
            raise CheckpointError(
                f"{name} does not fit its own preset: {str(error).splitlines()[1].strip()}"
            ) from error
        return network


def write_weights(network: StorableNetwork, path: Path, provenance: Provenance | None = None) -> None:
    """Store weights with their preset: float16, or float32 for tensors of up to MAX_EXACT numbers."""
    origin = provenance or Provenance()
    optional = {"step": origin.step, "data_sha256": origin.data_sha256, "card": origin.card}
    metadata = {"format": network.KIND, "version": network.VERSION, "preset": json.dumps(asdict(network.preset))}
    metadata |= {name: str(value) for name, value in optional.items() if value is not None}
    stored = {name: value.detach().cpu().contiguous() for name, value in network.state_dict().items()}
    save_file({name: one if one.numel() <= MAX_EXACT else one.half() for name, one in stored.items()}, path, metadata)


def read_weights(path: Path) -> WeightsFile:
    """Read a weights file; tensors become float32.

    Raises:
        CheckpointError: not a safetensors file.
    """
    try:
        with safe_open(path, "pt") as stored:
            metadata = stored.metadata() or {}
            tensors = {name: stored.get_tensor(name).float() for name in stored.keys()}  # noqa: SIM118
    except SafetensorError as error:
        raise CheckpointError(f"{path.name} is no safetensors file ({error}); give a trained model") from error
    step = metadata.get("step")
    return WeightsFile(
        kind=metadata.get("format", "unknown"),
        version=metadata.get("version", "unknown"),
        preset=json.loads(metadata.get("preset", "{}")),
        tensors=tensors,
        provenance=Provenance(
            step=None if step is None else int(step), data_sha256=metadata.get("data_sha256"), card=metadata.get("card")
        ),
    )
