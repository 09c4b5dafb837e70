"""One textbook effect each, on machines of every scale."""
