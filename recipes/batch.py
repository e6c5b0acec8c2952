"""Every mesh of a folder through a service, some at a time; called again, it goes on where it stopped.

python -m recipes.batch trees/ -o out --url http://127.0.0.1:8000
"""

import argparse
import asyncio
import hashlib
from pathlib import Path

from dynamictree_client import AsyncClient, ClientError, operations
from dynamictree_client.models import AnimateParams, AnimateRequest, Wind

MESHES = (".glb", ".ply", ".stl", ".obj")
AT_ONCE = 8  # concurrent uploads and jobs


async def sway(client: AsyncClient, path: Path, folder: Path, params: AnimateParams) -> None:
    """Animate one tree. The job's idempotency key is a hash of its inputs, so repeats within a day create one job."""
    asset = await client.upload(path)
    request = AnimateRequest(type="animate", asset_id=asset.id, params=params)
    digest = hashlib.sha256(request.model_dump_json().encode()).hexdigest()
    job = await client.create_job(request, key=f"batch-{digest}")
    if job.state == "failed":
        job = await client.send(operations.retry_job(job.id))
    await client.download_all(await client.wait(job), folder)


async def sway_all(url: str, trees: list[Path], output: Path, params: AnimateParams) -> dict[str, str]:
    """Animate all trees; return the errors by name."""
    failed: dict[str, str] = {}
    places = asyncio.Semaphore(AT_ONCE)
    async with AsyncClient(url) as client:

        async def one(path: Path) -> None:
            async with places:
                try:
                    await sway(client, path, output / path.stem, params)
                    print(f"  {path.name}")
                except ClientError as error:
                    failed[path.name] = str(error)

        await asyncio.gather(*map(one, trees))
    return failed


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="of meshes")
    parser.add_argument("-o", "--output", type=Path, required=True, help="gets a folder a tree")
    parser.add_argument("--url", default="http://127.0.0.1:8000")
    parser.add_argument("--format", default="glb", help="comma-separated")
    parser.add_argument("--num-steps", type=int, help="sampler steps; the preset's own if not given")
    parser.add_argument("--wind-speed", type=float, default=5.0, help="m/s")
    chosen = parser.parse_args(arguments)
    trees = sorted(path for path in chosen.folder.iterdir() if path.suffix.lower() in MESHES)
    wind = Wind(speed_m_s=chosen.wind_speed)
    params = AnimateParams(wind=wind, formats=chosen.format.split(","), num_steps=chosen.num_steps)
    failed = asyncio.run(sway_all(chosen.url, trees, chosen.output, params))
    print(f"{len(trees) - len(failed)} of {len(trees)} trees sway")
    for name, why in failed.items():
        print(f"  {name}: {why}")
    return 1 if failed else 0


if __name__ == "__main__":
    raise SystemExit(main())
