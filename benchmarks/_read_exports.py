"""Read exports without the code that writes them: displacement at every key, +Z up [m]."""

import io
import json
import tempfile
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib
from scipy.spatial.transform import Rotation

WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
COMPONENTS = {5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}


def accessor(document: Any, index: int) -> np.ndarray:
    """Return an accessor's elements as stored, decoded by meshoptimizer if compressed."""
    entry = document.accessors[index]
    view = document.bufferViews[entry.bufferView]
    width, component = WIDTHS[entry.type], np.dtype(COMPONENTS[entry.componentType])
    content, start = document.binary_blob(), (view.byteOffset or 0) + (entry.byteOffset or 0)
    stride = view.byteStride or width * component.itemsize
    if packed := (view.extensions or {}).get("EXT_meshopt_compression"):
        import meshopt

        part = content[packed["byteOffset"] : packed["byteOffset"] + packed["byteLength"]]
        facts = packed["count"], packed["byteStride"], packed["mode"], packed.get("filter", "NONE")
        content, start = meshopt.decode_gltf_buffer(part, *facts).tobytes(), entry.byteOffset or 0
    rows = np.frombuffer(content, np.uint8, entry.count * stride, start).reshape(-1, stride)
    return np.ascontiguousarray(rows[:, : width * component.itemsize]).view(component)


def z_up(vectors: np.ndarray) -> np.ndarray:
    return np.stack([vectors[..., 0], -vectors[..., 2], vectors[..., 1]], axis=-1)


def reported_facts(content: bytes) -> dict[str, Any]:
    """Return the `asset.extras` of a GLB."""
    extras: dict[str, Any] = pygltflib.GLTF2().load_from_bytes(content).asset.extras
    return extras


def read_morphs(content: bytes) -> np.ndarray:
    """Return a GLB's morph targets, weighted by its animation: [T + 1, N, 3]."""
    document = pygltflib.GLTF2().load_from_bytes(content)
    targets = [accessor(document, target["POSITION"]) for target in document.meshes[0].primitives[0].targets]
    targets = [one / 32767 if one.dtype == np.int16 else one for one in targets]
    keys = accessor(document, document.animations[0].samplers[0].output).reshape(-1, len(targets))
    return z_up(np.einsum("tm,mnc->tnc", keys, np.stack(targets)))


class _Entry(dict[str, Any]):
    """Object of a GLB's JSON: its fields are attributes, None if the file lacks them."""

    __getattr__ = dict.get


def _document(content: bytes) -> Any:
    """Read a GLB as pygltflib does, which takes a second for the accessors of 380 joints."""
    length = int.from_bytes(content[12:16], "little")
    document = json.loads(content[20 : 20 + length], object_hook=_Entry)
    document.binary_blob = lambda: content[28 + length :]
    return document


def read_skin(content: bytes) -> np.ndarray:
    """Return a GLB's skin, posed by its animation: [T + 1, N, 3]. glTF 2.0, sections 3.7.3, 3.11 and appendix C."""
    document = _document(content)
    attributes, skin = document.meshes[0].primitives[0].attributes, document.skins[0]
    rest = accessor(document, attributes.POSITION).astype(np.float64)
    joints, weights = accessor(document, attributes.JOINTS_0), accessor(document, attributes.WEIGHTS_0) / 255
    inverse = accessor(document, skin.inverseBindMatrices).reshape(-1, 4, 4).swapaxes(1, 2).astype(np.float64)
    world = world_matrices(document)
    matrices = np.stack([world[node] for node in skin.joints], axis=1) @ inverse  # [T + 1, B, 4, 4]
    homogeneous = np.concatenate([rest, np.ones((len(rest), 1))], axis=1)
    first = np.eye(4)  # joint 0 at rest
    first[:3, 3] = document.nodes[skin.joints[0]].translation
    rest = homogeneous @ (first @ inverse[0])[:3].T
    moved = [
        np.einsum("nj,njik,nk->ni", weights, frame[joints], homogeneous, optimize=True)[:, :3] for frame in matrices
    ]
    return z_up(np.stack(moved) - rest)


def world_matrices(document: Any) -> dict[int, np.ndarray]:
    """Return the matrix of every node at every key: [T + 1, 4, 4]."""
    animation = document.animations[0]
    moving: dict[int, np.ndarray] = {}
    for channel in animation.channels:
        assert channel.target.path == "rotation"
        keys = accessor(document, animation.samplers[channel.sampler].output)
        moving[channel.target.node] = Rotation.from_quat(keys).as_matrix()
    num_keys = len(next(iter(moving.values())))
    world: dict[int, np.ndarray] = {}

    def visit(node: int, above: np.ndarray) -> None:
        entry = document.nodes[node]
        local = np.broadcast_to(np.eye(4), (num_keys, 4, 4)).copy()
        local[:, :3, 3] = entry.translation or (0, 0, 0)
        if node in moving:
            local[:, :3, :3] = moving[node]
        world[node] = above @ local
        for child in entry.children or []:
            visit(child, world[node])

    for root in document.scenes[document.scene].nodes:
        visit(root, np.broadcast_to(np.eye(4), (num_keys, 4, 4)))
    return world


def read_usdz(path: Path) -> np.ndarray:
    """Return the points of every time code minus those at rest: [T, N, 3]."""
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.Open(str(path))
    surfaces = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
    points = UsdGeom.Mesh(surfaces[0]).GetPointsAttr()
    assert points.GetTimeSamples() == list(range(int(stage.GetEndTimeCode()) + 1))
    rest = np.array(points.Get())
    return np.stack([np.array(points.Get(code)) for code in points.GetTimeSamples()]) - rest


def read_usd_skin(path: Path) -> np.ndarray:
    """Return the points of every time code, skinned by usd-core, minus those at rest: [T, N, 3]."""
    from pxr import Usd, UsdGeom, UsdSkel, Vt

    stage = Usd.Stage.Open(str(path))
    [surface] = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
    root = UsdSkel.Root(stage.GetDefaultPrim())
    cache = UsdSkel.Cache()
    cache.Populate(root, Usd.PrimDefaultPredicate)
    skinning = cache.GetSkinningQuery(surface)
    skeleton = cache.GetSkelQuery(UsdSkel.Skeleton(stage.GetPrimAtPath("/Tree/Skeleton")))
    rest = UsdGeom.Mesh(surface).GetPointsAttr().Get()
    frames = []
    for code in range(int(stage.GetEndTimeCode()) + 1):
        points = Vt.Vec3fArray(rest)
        assert skinning.ComputeSkinnedPoints(skeleton.ComputeSkinningTransforms(code), points, code)
        frames.append(np.array(points))
    return np.stack(frames) - np.array(rest)


def read_alembic(path: Path) -> np.ndarray:
    """Return the points of every sample: [T, N, 3]."""
    from alembic3d import Abc, AbcGeom

    schema = AbcGeom.IPolyMesh(Abc.IArchive(str(path)).getTop(), "tree").getSchema()
    samples = schema.getPositionsProperty().samples
    return z_up(np.stack([np.array(memoryview(points)) for points in samples]))


def read_vertex_texture(content: bytes) -> np.ndarray:
    """Return the texels that a vertex shader looks up in each frame: [T, N, 3]. Needs OpenEXR."""
    import OpenEXR

    archive = zipfile.ZipFile(io.BytesIO(content))
    facts = json.loads(archive.read(archive.namelist()[0]))
    with tempfile.TemporaryDirectory() as folder:
        picture = archive.extract(facts["texture"], folder)
        texels = OpenEXR.File(picture).channels()["RGB"].pixels.astype(np.float32)
    document = pygltflib.GLTF2().load_from_bytes(archive.read(facts["mesh"]))
    u, v = accessor(document, getattr(document.meshes[0].primitives[0].attributes, facts["lookup_attribute"])).T
    assert texels.shape == (facts["height"], facts["width"], 3)
    frames = []
    for frame in range(facts["num_frames"]):
        row = np.floor((v + frame * facts["rows_per_frame"] / facts["height"]) * facts["height"]).astype(int)
        frames.append(texels[row, np.floor(u * facts["width"]).astype(int)])
    return z_up(np.stack(frames))


def read_ply(path: Path) -> np.ndarray:
    """Return the vertices of every file of a sequence, read by trimesh: [T, N, 3]."""
    import trimesh

    archive = zipfile.ZipFile(path)
    files = (io.BytesIO(archive.read(name)) for name in archive.namelist())
    return np.stack([trimesh.load(file, file_type="ply", process=False).vertices for file in files])


def read_product(name: str, path: Path, rest: np.ndarray) -> np.ndarray:
    """Return the displacement at every frame of a product; `rest` is subtracted from formats with positions."""
    from safetensors.numpy import load_file

    if name in ("alembic", "ply"):
        return {"alembic": read_alembic, "ply": read_ply}[name](path) - rest
    if name in ("usd", "usd-skinned"):
        return {"usd": read_usdz, "usd-skinned": read_usd_skin}[name](path)
    if name == "motion":
        return load_file(path)["displacement"]
    play = {"glb": read_skin, "vat": read_vertex_texture}.get(name, read_morphs)
    return play(path.read_bytes())
