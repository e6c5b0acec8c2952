"""Choice of one of several trees."""

import numpy as np
from jaxtyping import Int32

from dynamictree.errors import InputError
from dynamictree.mesh import SourceWarning


def require_tree(number: int, tree_of: Int32[np.ndarray, " E"] | None) -> None:
    """Check the number of a tree, counted from 1, where each element's tree is counted from 0; None for one tree.

    Raises:
        InputError: there is no such tree.
    """
    count = 1 if tree_of is None else int(tree_of.max()) + 1
    if not 1 <= number <= count:
        trees = "1 tree" if count == 1 else f"{count} trees, numbered from 1"
        raise InputError(f"tree is {number}, and the file holds {trees}")


def several_trees(count: int) -> SourceWarning:
    """Tell that a file holds several trees."""
    message = (
        f"{count} trees stand in the file; each moves by itself; tree=1 to tree={count} takes one of them, and "
        "`trees` lists where they stand"
    )
    return SourceWarning(code="several-trees", message=message)
