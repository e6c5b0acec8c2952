"""Load a trained model of any kind, by name or from a file."""

from functools import lru_cache

from dynamictree.errors import CheckpointError
from dynamictree.models.motion_model import MotionModel
from dynamictree.models.weights_file import read_weights
from dynamictree.weights import weights_path


def load_model(name_or_path: str = "small") -> MotionModel:
    """Load a model by a name of `dynamictree.weights.list_weights`, or from a weights file.

    Raises:
        InputError: there is no such model.
        CheckpointError: the file's kind or version is not supported.
    """
    from dynamictree.models.paper.generate import PaperModel
    from dynamictree.models.paper.network import PaperNetwork
    from dynamictree.models.small.generate import SmallModel
    from dynamictree.models.small.network import SmallNetwork

    path = weights_path(name_or_path)
    stored = read_weights(path)
    if (stored.kind, stored.version) == (SmallNetwork.KIND, SmallNetwork.VERSION):
        return SmallModel(stored.network(SmallNetwork, path.stem), name=path.stem)
    if (stored.kind, stored.version) == (PaperNetwork.KIND, PaperNetwork.VERSION):
        return PaperModel(stored.network(PaperNetwork, path.stem), name=path.stem)
    needed = ", ".join(f"{kind.KIND} version {kind.VERSION}" for kind in (SmallNetwork, PaperNetwork))
    raise CheckpointError(
        f"{path.name} is {stored.kind} version {stored.version}; {needed} can be loaded: "
        "train again, or run the release that made it"
    )


@lru_cache(maxsize=2)
def loaded_once(name_or_path: str) -> MotionModel:
    """Return a model, loaded once per process."""
    return load_model(name_or_path)
