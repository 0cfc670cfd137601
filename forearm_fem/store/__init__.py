"""Our own files: records, shelves of finished parts, resumable work, and results folders."""
