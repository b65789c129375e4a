"""What all commands share: options, help, errors, progress, tables, results."""

from cei_converters.cli.command_line import (
    DatasetConfig,
    SourceConfig,
    option_types,
    parse,
    quiet_libraries,
    run,
)

__all__ = ["DatasetConfig", "SourceConfig", "option_types", "parse", "quiet_libraries", "run"]
