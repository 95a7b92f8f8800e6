// The adapter of its device; see its header.
