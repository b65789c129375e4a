"""What takes a worker seconds to import; see `workers.warm_up`."""

import cei_converters.conversion.workers  # noqa: F401
