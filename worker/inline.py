"""Run jobs one after another without Redis, until stdin ends; started by `service.testing`.

`python -m worker.inline`.
"""

import select

from jobs.lifecycle.maintenance import messages_to_send
from jobs.logging_setup import set_up_logging
from worker.runtime import close_runtime, runtime
from worker.tasks import run_job

POLL_S = 0.1


def main() -> None:
    """Run each waiting job, until stdin ends."""
    resources = runtime()
    set_up_logging(resources.settings)
    while not select.select([0], [], [], POLL_S)[0]:
        for message in messages_to_send(resources.store, window=1):
            run_job.apply(args=message.args)
    close_runtime(resources)


if __name__ == "__main__":
    main()
