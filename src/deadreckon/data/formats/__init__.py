"""Files of logs: what tells formats apart (`io`), how any file becomes a `Dataset` (`build`), and a file a format."""
