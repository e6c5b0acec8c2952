"""The cache's bound holds also where values grow after they were put."""

from service.interact.lru_cache import LruCache


def test_the_bound_holds_after_growth() -> None:
    sizes = {"a": 10, "b": 10, "c": 10}
    cache = LruCache[str](100, sizes.__getitem__)
    for name in sizes:
        cache.put(name, name)
    sizes["b"] = 95
    cache.trim()
    assert (cache.get("a"), cache.get("b"), cache.get("c")) == (None, None, "c")
    sizes["c"] = 1000
    cache.put("a", "a")
    assert (cache.get("c"), cache.get("a")) == (None, "a")
    cache.put("c", "c")
    assert (cache.get("c"), len(cache)) == ("c", 1)  # the newest stays
