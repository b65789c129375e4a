"""A LeRobot dataset on disk, ours or anybody's: its files, columns, pictures and metadata."""
