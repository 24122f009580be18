"""Raw sensor packets in captures; :mod:`..ros` reads them from bags."""
