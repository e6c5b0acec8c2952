"""Schemathesis over the whole OpenAPI page, against a real server: `python -m tests.contract.attack --examples 50`.

All checks, and the documented answers to what breaks the page's rules. Arguments after `--` go to schemathesis.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.servers import api, valkey

CONFIG = Path(__file__).with_name("schemathesis.toml")
LEFT_OUT = ("/events",)
"""Answers that never end."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--examples", type=int, default=50, help="requests of each kind an operation")
    parser.add_argument("--seed", type=int, default=1)
    given, rest = parser.parse_known_args()
    with tempfile.TemporaryDirectory(prefix="attack-") as scratch:
        folder = Path(scratch)
        queue, redis_url = valkey(folder)
        settings = {"DYNAMICTREE_STATE_DIR": str(folder / "state"), "DYNAMICTREE_REDIS_URL": redis_url}
        front, url = api(folder, settings)
        for part in (queue, front):
            part.start()
        binary = Path(sys.executable).with_name("schemathesis")
        command = [str(binary), "--config-file", str(CONFIG), "run", url + "/openapi.json", "--checks", "all"]
        command += ["-n", str(given.examples), "--seed", str(given.seed), "--request-timeout", "30"]
        for ending in LEFT_OUT:
            command += ["--exclude-path-regex", f"{ending}$"]
        done = subprocess.run(
            [*command, *rest], env=os.environ | {"SCHEMATHESIS_HOOKS": "tests.contract.octets"}, check=False
        )
        for part in (front, queue):
            part.stop()
    sys.exit(done.returncode)


if __name__ == "__main__":
    main()
