"""Write the secrets that docker-compose.yml names into docker/secrets, once: `python docker/make_secrets.py`."""

import secrets
import sys
from pathlib import Path

FOLDER = Path(__file__).parent / "secrets"


def main(folder: Path = FOLDER) -> None:
    """Make the database's password, the URL that holds it, object storage's key and secret. What is there stays."""
    folder.mkdir(mode=0o700, exist_ok=True)
    password = folder / "postgres_password"
    if password.exists():
        sys.stderr.write(f"{password} is there already; nothing was changed\n")
        return
    chosen = secrets.token_urlsafe(32)
    url = f"postgresql://tree:{chosen}@postgres:5432/tree"
    made = {
        password: chosen,
        folder / "dynamictree_database_url": url,
        folder / "dynamictree_s3_access_key_id": secrets.token_hex(10),
        folder / "dynamictree_s3_secret_access_key": secrets.token_urlsafe(30),
    }
    for path, text in made.items():
        path.write_text(text)
        path.chmod(0o444)  # read by another user inside the container; the folder keeps others out


if __name__ == "__main__":
    main()
