"""What a shutter really played: logic-analyser recordings, and their edges against the program."""
