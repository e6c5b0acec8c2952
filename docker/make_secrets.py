"""Write the secrets that docker-compose.yml names into docker/secrets, once: `python docker/make_secrets.py`."""

import json
import secrets
import sys
from pathlib import Path

FOLDER = Path(__file__).parent / "secrets"


def main(folder: Path = FOLDER) -> None:
    """Write every secret that docker-compose.yml names. What is there stays."""
    folder.mkdir(mode=0o700, exist_ok=True)
    password = _ensure(folder / "postgres_password", secrets.token_urlsafe(32))
    _ensure(folder / "dynamictree_database_url", f"postgresql://tree:{password}@postgres:5432/tree")
    access_key = _ensure(folder / "dynamictree_s3_access_key_id", secrets.token_hex(10))
    secret_key = _ensure(folder / "dynamictree_s3_secret_access_key", secrets.token_urlsafe(30))
    identity = {
        "name": "dynamictree",
        "credentials": [{"accessKey": access_key, "secretKey": secret_key}],
        "actions": ["Admin", "Read", "Write", "List"],  # Admin creates the bucket at the first upload
    }
    _ensure(folder / "seaweedfs_s3.json", json.dumps({"identities": [identity]}))


def _ensure(path: Path, text: str) -> str:
    """Return the file's text; write it first where there is no file."""
    if path.exists():
        sys.stderr.write(f"{path} is there already; it was not changed\n")
        return path.read_text()
    path.write_text(text)
    path.chmod(0o444)  # read by another user inside the container; the folder keeps others out
    return text


if __name__ == "__main__":
    main()
