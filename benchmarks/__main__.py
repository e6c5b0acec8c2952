"""Run the benchmarks that are named, or all of them."""

import importlib
import json
import pkgutil
import sys

import benchmarks


def main() -> None:
    names = sorted(
        module.name for module in pkgutil.iter_modules(benchmarks.__path__) if not module.name.startswith("_")
    )
    unknown = [name for name in sys.argv[1:] if name not in names]
    if unknown:
        raise SystemExit(f"benchmarks: no such name: {', '.join(unknown)}; there are {', '.join(names)}")
    for name in sys.argv[1:] or names:
        print(json.dumps({"benchmark": name, **importlib.import_module(f"benchmarks.{name}").run()}), flush=True)


if __name__ == "__main__":
    main()
