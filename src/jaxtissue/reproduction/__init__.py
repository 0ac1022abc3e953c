"""The paper's evaluation made again: tissues, experiments, figures, verdicts, and the report on them."""
