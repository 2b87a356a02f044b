// Compiles to nothing: its target makes the precompiled header that all test programs reuse.
