"""Which model is live, since when and why: the gate, the models as rows, roll-back, export and import."""
