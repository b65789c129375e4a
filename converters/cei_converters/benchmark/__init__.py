"""The benchmarks that users run: `cei-benchmark`."""
