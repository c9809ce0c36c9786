"""Commands that are too long for the list of them in `mckibben.cli`: what is asked, what is shown, one module each."""
