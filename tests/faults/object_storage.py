"""A real S3 server in one process: OpenStack Swift and its s3api, one device, one replica.

`python -m tests.faults.object_storage FOLDER PORT`. It checks signatures; key, secret and bucket are those below.
While the folder holds a file `busy`, it answers 503 as S3 does where there is too much to do.
"""

import sys
import warnings
from collections.abc import Callable
from pathlib import Path

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import eventlet

    eventlet.monkey_patch()

from eventlet import wsgi
from swift.common.ring import RingBuilder
from swift.common.swob import Request
from swift.common.utils import set_swift_dir
from swift.common.wsgi import loadapp

KEY, SECRET, BUCKET = "tree:tree", "secret", "trees"

PROXY = """
[DEFAULT]
swift_dir = {folder}
[pipeline:main]
pipeline = catch_errors cache s3api tempauth dlo slo proxy-server
[app:proxy-server]
use = egg:swift#proxy
account_autocreate = true
[filter:catch_errors]
use = egg:swift#catch_errors
[filter:cache]
use = egg:swift#memcache
memcache_servers = 127.0.0.1:1
[filter:s3api]
use = egg:swift#s3api
location = us-east-1
[filter:tempauth]
use = egg:swift#tempauth
user_tree_tree = secret .admin
[filter:dlo]
use = egg:swift#dlo
[filter:slo]
use = egg:swift#slo
allow_async_delete = false
"""
SERVER = """
[DEFAULT]
swift_dir = {folder}
devices = {folder}/devices
mount_check = false
[app:main]
use = egg:swift#{name}
"""


def main(folder: Path, port: int) -> None:
    (folder / "devices" / "disk").mkdir(parents=True, exist_ok=True)
    (folder / "swift.conf").write_text("[swift-hash]\nswift_hash_path_suffix = tree\n")
    set_swift_dir(str(folder))
    inner = {name: eventlet.listen(("127.0.0.1", 0)) for name in ("account", "container", "object")}
    for name, listening in inner.items():
        ring = RingBuilder(1, 1, 0)
        at = {"ip": "127.0.0.1", "port": listening.getsockname()[1], "device": "disk"}
        ring.add_dev({"id": 0, "region": 1, "zone": 1, "weight": 1.0, **at})
        ring.rebalance()
        ring.get_ring().save(str(folder / f"{name}.ring.gz"))
    for name, listening in inner.items():
        eventlet.spawn(wsgi.server, listening, load(folder, name, SERVER), log_output=False)
    proxy = load(folder, "proxy", PROXY)
    allowed = {"REQUEST_METHOD": "PUT", "swift.authorize_override": True, "swift.authorize": lambda _: None}
    response = Request.blank(f"/v1/AUTH_tree/{BUCKET}", environ=allowed).get_response(proxy)
    assert response.is_success, response.status

    def front(environment: dict[str, object], start_response: Callable[..., object]) -> object:
        if (folder / "busy").exists():
            start_response("503 Slow Down", [("Content-Type", "application/xml")])
            return [b"<Error><Code>SlowDown</Code><Message>Reduce your request rate.</Message></Error>"]
        return proxy(environment, start_response)

    wsgi.server(eventlet.listen(("127.0.0.1", port), backlog=512), front, log_output=False)


def load(folder: Path, name: str, text: str) -> Callable[..., object]:
    path = folder / f"{name}.conf"
    path.write_text(text.format(folder=folder, name=name))
    return loadapp(str(path))


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve(), int(sys.argv[2]))
