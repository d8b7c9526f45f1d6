"""Full-order answers and histories: at training parameters and held out, computed and kept on disk."""
