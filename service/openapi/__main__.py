"""`python -m service.openapi`: print the OpenAPI document, as it is committed."""

import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from jobs.settings import Settings
from service.app import create_app

if __name__ == "__main__":
    with TemporaryDirectory() as folder:
        page = create_app(Settings(state_dir=Path(folder))).openapi()
    sys.stdout.write(json.dumps(page, indent=1, ensure_ascii=False) + "\n")
