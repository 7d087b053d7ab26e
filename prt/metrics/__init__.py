"""Quality, time, stability, and the statistics over them."""
