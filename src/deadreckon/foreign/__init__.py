"""The one door for bytes that come from elsewhere: what is opened, how much it may take, and which process reads it."""
