"""One file per method, each readable beside its paper."""
