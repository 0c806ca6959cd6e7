"""The commands, one file each: ``run(options)`` reads files, calls the library, writes files."""
