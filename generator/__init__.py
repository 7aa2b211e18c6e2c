"""Text or files to two-person motion. Torch-free except where a module says otherwise."""
