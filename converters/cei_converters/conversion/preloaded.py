"""What takes a worker seconds to import; see `workers.warm_up`."""

import datasets  # noqa: F401
import lerobot.datasets  # noqa: F401

import cei_converters.conversion.workers  # noqa: F401
