"""`*.ties.safetensors`: what ties a mesh's vertices to the voxels of a grid, with the factors of its fit. Internal.

The same for all seeds and winds of a tree. Double precision and flags lie in it as bytes.
"""

from dataclasses import fields

import numpy as np
import scipy.sparse
from jaxtyping import Shaped, UInt8

from dynamictree.byte_stream import ByteReader, ByteWriter
from dynamictree.devoxelize.attachment import Attachments
from dynamictree.devoxelize.interpolation import VoxelInterpolation
from dynamictree.devoxelize.surface_fit import SurfaceFit
from dynamictree.devoxelize.symmetric_factor import SymmetricFactor
from dynamictree.formats.tensors.container import integer, read_tensors, write_tensors

FORMAT, VERSION = "vertex-ties", "2"
Tensors = dict[str, Shaped[np.ndarray, "..."]]


def write_ties(ties: VoxelInterpolation, stream: ByteWriter) -> None:
    """Write; undone bit by bit by `read_ties`."""
    assert ties.attachments is not None
    assert ties.fitted is not None
    tensors: Tensors = {"rows": ties.rows, "weights": ties.weights, "fitted": ties.fitted}
    tensors |= {f"attached_{name}": getattr(ties.attachments, name) for name in _names(Attachments)}
    if ties.still is not None:
        tensors["still"] = ties.still.view(np.uint8)
    if ties.fit is not None:
        factor = ties.fit.factor
        tensors |= {"order": factor.order, "ends": factor.ends, "factor_rows": factor.rows}
        tensors |= {"factor_values": _bytes(factor.values), "inverse": _bytes(factor.inverse)}
        tensors |= _sparse("pull", ties.fit.pull)
        if ties.fit.prolongation is not None:
            tensors |= _sparse("prolongation", ties.fit.prolongation)
    metadata = {"format": FORMAT, "version": VERSION, "num_voxels": str(ties.num_voxels)}
    if ties.fit is not None:
        metadata["num_nodes"] = str(len(ties.fit.factor.order))
    write_tensors(stream, tensors, metadata)


def read_ties(stream: ByteReader) -> VoxelInterpolation:
    """Read.

    Raises:
        FormatError: the file is none of a known version.
    """
    tensors, metadata = read_tensors(stream, file_format=FORMAT, version=VERSION)
    num_voxels = integer(metadata, "num_voxels", low=1, high=2**31)
    fit = None
    if "order" in tensors:
        num_nodes = integer(metadata, "num_nodes", low=1, high=2**31)
        factor = SymmetricFactor(
            order=tensors["order"],
            ends=tensors["ends"],
            rows=tensors["factor_rows"],
            values=tensors["factor_values"].view(np.float64),
            inverse=tensors["inverse"].view(np.float64),
        )
        prolongation = _matrix(tensors, "prolongation", num_nodes) if "prolongation_ends" in tensors else None
        fit = SurfaceFit(pull=_matrix(tensors, "pull", num_voxels), factor=factor, prolongation=prolongation)
    return VoxelInterpolation(
        rows=tensors["rows"],
        weights=tensors["weights"],
        num_voxels=num_voxels,
        fit=fit,
        fitted=tensors["fitted"],
        attachments=Attachments(**{name: tensors[f"attached_{name}"] for name in _names(Attachments)}),
        still=tensors["still"].view(np.bool_) if "still" in tensors else None,
    )


def _names(kind: type) -> list[str]:
    return [field.name for field in fields(kind)]


def _bytes(values: Shaped[np.ndarray, " n"]) -> UInt8[np.ndarray, " n8"]:
    return np.ascontiguousarray(values, np.float64).view(np.uint8)


def _sparse(name: str, matrix: scipy.sparse.csr_array) -> Tensors:
    return {
        f"{name}_ends": matrix.indptr.astype(np.int32),
        f"{name}_columns": matrix.indices.astype(np.int32),
        f"{name}_values": _bytes(matrix.data),
    }


def _matrix(tensors: Tensors, name: str, num_columns: int) -> scipy.sparse.csr_array:
    ends = tensors[f"{name}_ends"]
    parts = (tensors[f"{name}_values"].view(np.float64), tensors[f"{name}_columns"], ends)
    return scipy.sparse.csr_array(parts, shape=(len(ends) - 1, num_columns))
