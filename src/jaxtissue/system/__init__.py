"""Services of the operating system: files written whole, locks, signals, streams, processor cores."""
