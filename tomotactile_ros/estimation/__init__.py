"""One estimate of contacts, sheet and channels from whatever rows there are
(docs/estimation.md)."""
