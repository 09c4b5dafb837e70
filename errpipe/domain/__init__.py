"""The nouns: frozen, validated, without arithmetic."""
