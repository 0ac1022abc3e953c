"""JAX and XLA only: settings, fusion, programs batched over replicas and kept on the disk, devices."""
