"""Run the named benchmarks; print the figures of each as one JSON object per line."""

import importlib
import json
import pkgutil
import sys

import benchmarks


def names() -> list[str]:
    """Return the names of all benchmarks."""
    modules = (module.name for module in pkgutil.iter_modules(benchmarks.__path__))
    return sorted(name for name in modules if not name.startswith("_"))


def main() -> None:
    """Run the benchmarks named on the command line; without a name, list them."""
    unknown = [name for name in sys.argv[1:] if name not in names()]
    if unknown or not sys.argv[1:]:
        problem = f"no such name: {', '.join(unknown)}" if unknown else "name some"
        raise SystemExit(f"benchmarks: {problem}; there are {', '.join(names())}")
    for name in sys.argv[1:]:
        print(json.dumps({"benchmark": name, **importlib.import_module(f"benchmarks.{name}").run()}), flush=True)


if __name__ == "__main__":
    main()
