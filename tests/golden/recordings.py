"""The corpus: recordings in ``../shared/data``, where they are at hand."""

from __future__ import annotations

from samples.real import SHARED

from .corpus import GROUPS as GROUPS
