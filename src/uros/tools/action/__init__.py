"""``uros action``: a module for each verb.

=============  ====================================================================================
``echo``       ``uros action echo``: print the messages of an action
``find``       ``uros action find``: list actions of a type
``goal``       A goal that a verb sends: its services, feedback, result and cancellation
``info``       ``uros action info``: print information about an action
``list``       ``uros action list``: list actions
``send_goal``  ``uros action send_goal``: send a goal, and print its result
``type``       ``uros action type``: print the type of an action
=============  ====================================================================================
"""
