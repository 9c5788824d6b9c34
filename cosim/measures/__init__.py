"""Metrics and statistics: contacts, surrogate safety, relation labels, intervals and paired tests."""
