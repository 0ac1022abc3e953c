"""JAX and XLA only: settings, fusion, programs batched over replicas and stored on disk, devices."""
