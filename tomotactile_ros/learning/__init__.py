"""The sensor learned from ordinary touches: sheet, gains, offsets and resistances
(docs/estimation.md)."""
