"""The motion of vertices is computed once per spectrum and mesh, and is the same from its files as fresh."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dynamictree import method
from dynamictree.devoxelize.inextensible import typical_stretch
from dynamictree.devoxelize.length_preserving import length_preserving
from dynamictree.errors import Cancelled
from dynamictree.export import vertex_motion
from dynamictree.export.write import write_products
from dynamictree.mesh import TriangleMesh
from dynamictree.modal import fitted_skin
from dynamictree.requests import ExportParams
from dynamictree.spectrum import SparseVoxelSpectrum
from tests.devoxelize.test_interpolation import two_close_twigs


class Folder:
    """A place for results that counts how often each is computed."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.computed: list[str] = []

    def recall(self, name: str, make: Callable[[Path], None]) -> Path:
        path = self.root / f"{name}.stored"
        if not path.exists():
            self.computed.append(name)
            make(path)
        return path


def spectrum_of(mesh: TriangleMesh, *, lean_m: float, at: int = 1) -> SparseVoxelSpectrum:
    grid = method.voxelize(mesh, resolution=64).grid
    coefficients = np.zeros((len(grid), 4, 3), np.complex64)
    height = grid.centres_m[:, 2] - grid.centres_m[:, 2].min()
    coefficients[:, at, 0] = lean_m * (height / height.max()) ** 2
    return SparseVoxelSpectrum(grid=grid, coefficients=coefficients)


@pytest.mark.parametrize("lean_m", [0.01, 1.0], ids=["breeze", "storm"])
def test_products_of_two_requests_are_those_of_one(tmp_path: Path, lean_m: float) -> None:
    mesh, _ = two_close_twigs()
    spectrum = spectrum_of(mesh, lean_m=lean_m)
    ties = length_preserving(spectrum.grid, mesh)
    assert (typical_stretch(ties, ties.apply(spectrum.coefficients)) > 0.01) == (lean_m == 1.0)
    stored = Folder(tmp_path)
    written = {}
    for formats in (("motion",), ("ply",), ("motion", "ply")):
        folder = tmp_path / "-".join(formats)
        folder.mkdir()
        recall = stored.recall if len(formats) == 1 else None
        paths = write_products(mesh, spectrum, ExportParams(formats=formats), folder, recall=recall)
        written[formats] = {name: path.read_bytes() for name, path in paths.items()}
    assert written["motion",] | written["ply",] == written["motion", "ply"]
    assert sorted(stored.computed) == ["motion", "ties"]


@pytest.mark.parametrize("lean_m", [0.01, 1.0], ids=["breeze", "storm"])
def test_a_sum_of_frequencies_stretches_no_edge_in_a_storm(lean_m: float) -> None:
    mesh, _ = two_close_twigs()
    spectrum = spectrum_of(mesh, lean_m=lean_m, at=3)
    motion, _ = vertex_motion.vertex_motion(mesh, spectrum, on_progress=lambda done: None)
    ties = length_preserving(spectrum.grid, mesh)
    assert typical_stretch(ties, motion.loop) <= 0.02
    assert (typical_stretch(ties, motion.coefficients) > 0.02) == (lean_m == 1.0)
    assert (motion.loop.shape[1] > spectrum.num_frequencies) == (lean_m == 1.0)
    np.testing.assert_array_equal(motion.loop[:, : spectrum.num_frequencies], motion.coefficients)


def test_a_loop_gets_no_more_frequencies_than_are_stored(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh, _ = two_close_twigs()
    spectrum = spectrum_of(mesh, lean_m=1.0, at=3)
    monkeypatch.setattr(vertex_motion, "MAX_STORED_BYTES", 24 * mesh.num_vertices * 11)
    motion, _ = vertex_motion.vertex_motion(mesh, spectrum, on_progress=lambda done: None)
    assert motion.loop.shape[1] == 11 - spectrum.num_frequencies


def test_what_keeps_lengths_is_factored_once_for_all_products(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mesh, _ = two_close_twigs()
    factored: list[int] = []
    whole = vertex_motion.pose_of
    monkeypatch.setattr(vertex_motion, "pose_of", lambda ties, linear: factored.append(1) or whole(ties, linear))
    write_products(mesh, spectrum_of(mesh, lean_m=1.0), ExportParams(formats=("motion", "ply", "glb")), tmp_path)
    assert len(factored) == 1


def test_another_wind_of_a_tree_shares_what_ties_its_vertices(tmp_path: Path) -> None:
    mesh, _ = two_close_twigs()
    stored = Folder(tmp_path)
    for name, lean_m in (("calm", 0.01), ("strong", 0.02)):
        folder = tmp_path / name
        folder.mkdir()
        (tmp_path / "motion.stored").unlink(missing_ok=True)  # as under a key of its own
        write_products(
            mesh, spectrum_of(mesh, lean_m=lean_m), ExportParams(formats=("glb",)), folder, recall=stored.recall
        )
    assert stored.computed == ["motion", "ties", "motion"]


def test_two_products_of_one_skin_fit_it_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mesh, _ = two_close_twigs()
    fits, fitted = list[int](), fitted_skin.fitted_skin
    monkeypatch.setattr(
        fitted_skin, "fitted_skin", lambda *given, **options: fits.append(1) or fitted(*given, **options)
    )
    params = ExportParams(formats=("glb-skinned", "usd-skinned"), joints=32)
    write_products(mesh, spectrum_of(mesh, lean_m=0.01), params, tmp_path)
    assert len(fits) == 1


def test_a_storm_reports_progress_and_stops_before_its_first_file(tmp_path: Path) -> None:
    mesh, _ = two_close_twigs()
    spectrum, shares = spectrum_of(mesh, lean_m=1.0), list[float]()
    write_products(mesh, spectrum, ExportParams(formats=("glb",)), tmp_path, shares.append)
    assert shares == sorted(shares)
    assert len([share for share in shares if 0.2 < share <= 0.4]) >= 12  # the frames of the loop without stretch

    def cancel(share: float) -> None:
        if share > 0.3:
            raise Cancelled("stop")

    folder = tmp_path / "canceled"
    folder.mkdir()
    with pytest.raises(Cancelled):
        write_products(mesh, spectrum, ExportParams(formats=("glb",)), folder, cancel)
    assert list(folder.iterdir()) == []
