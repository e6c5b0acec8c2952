#!/bin/sh
# numba writes beside what it reads, so each container has its own copy of the image's compiled kernels (a few MB).
set -eu
. /usr/local/bin/kernel_target.sh
[ -d "$NUMBA_CACHE_DIR" ] || cp -r /opt/numba "$NUMBA_CACHE_DIR"
exec "$@"
