"""What the operating system gives: files written whole, locks, signals, streams, processor cores."""
