"""Write the secrets that docker-compose.yml names into docker/secrets, once: `python docker/make_secrets.py`."""

import secrets
import sys
from pathlib import Path

FOLDER = Path(__file__).parent / "secrets"


def main(folder: Path = FOLDER) -> None:
    """Make a password for the database, and the URL that holds it. What is there already stays."""
    folder.mkdir(mode=0o700, exist_ok=True)
    password = folder / "postgres_password"
    if password.exists():
        sys.stderr.write(f"{password} is there already; nothing was changed\n")
        return
    chosen = secrets.token_urlsafe(32)
    url = f"postgresql://tree:{chosen}@postgres:5432/tree"
    for path, text in ((password, chosen), (folder / "dynamictree_database_url", url)):
        path.write_text(text)
        path.chmod(0o444)  # read by another user inside the container; the folder keeps others out


if __name__ == "__main__":
    main()
