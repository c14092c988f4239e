"""How far off does Atrium believe its named positions to be, from predictions of what it had not seen yet?"""
