"""Files of logs: detection of formats (`kind`), reading and converting (`io`), common parts (`build`), and each format."""
