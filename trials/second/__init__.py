"""A second, independent generator of blind trials of the diagnosis: recordings with a key, in the public layout."""
