"""Classify names of materials and nodes: wood, leaves, soil, and objects that are no plant."""

import re
import unicodedata

WOOD = re.compile(r"bark|trunk|wood|stem|branch|log\b|stamm|rinde|tronc|holz|twig|limb", re.IGNORECASE)
LEAF = re.compile(r"lea[fv]|foliage|crown|needle|blatt|laub|feuill|frond|canopy|flower|blossom|petal", re.IGNORECASE)
STILL_NAMES = frozenset(
    " ".join(
        (
            "pot pots flowerpot plantpot vase planter soil dirt earth ground terrain table desk plate saucer dish",
            "water sea ocean lake river pond rock rocks stone stones pebble pebbles sand beach floor concrete",
            "road path pavement glass ceramic terracotta clay island plane wall fence bench trellis topf erde boden",
            "tisch wasser stein terre blumentopf vaso maceta jardiniere cachepot urn recipient",
        )
    ).split()
)
"""Words in names of materials and nodes that are no plant."""
OF_SHAPES = frozenset({"plane", "plate", "island", "earth", "wall", "path"})
"""Words that modelling programs use in default names of nodes (`Plane`, `NurbsPath`), or for a scene's root."""
SOIL_NAMES = frozenset(("soil", "dirt", "earth", "erde", "terre"))


def words(name: str) -> frozenset[str]:
    """Split a name at capitals, digits and signs into lower-case words without accents."""
    name = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
    return frozenset(word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name))


def is_still_name(name: str, *, but: frozenset[str] = frozenset()) -> bool:
    """Whether a name contains a word for an object that is no plant, other than those in `but`."""
    return not words(name).isdisjoint(STILL_NAMES - but)
