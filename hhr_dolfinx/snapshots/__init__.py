"""Full-order solutions: computed, kept on disk, and compared with."""
