"""The energy's gradient, and methods that go down it or sample by it."""
