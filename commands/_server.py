"""Imported first in the server from which drawing processes begin: what it loads stays, and is not looked through for garbage."""

from __future__ import annotations

import gc

gc.disable()
