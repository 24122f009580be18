"""Tools around a map: readers, commands, pictures. The core never imports them by itself."""
