"""A fit log for tests of methods."""


class Log:
    """Keeps what a fit reports."""

    def __init__(self, kept=None):
        self.kept, self.values = kept, {}

    def start(self, steps, label):
        pass

    def step(self, step, **values):
        self.values = values

    def checkpoint_due(self, step):
        return True

    def save(self, step, state):
        self.kept = (step, state)

    def resume(self):
        return self.kept
