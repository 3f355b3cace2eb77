"""action_peer.py with services and introspection, for the verbs of the command line."""

import rclpy
from action_peer import ActionPeer
from peer import find_type, profile
from rclpy.service_introspection import ServiceIntrospectionState


class VerbsPeer(ActionPeer):
    def __init__(self):
        super().__init__()
        self.services = {}
        self.clients_of = {}

    def introspect(self, entity, **qos):
        entity.configure_introspection(
            self.node.get_clock(), profile(**qos), ServiceIntrospectionState.CONTENTS
        )

    def do_act(self, name, introspected=False, seconds=15):
        """Serve the action, and enable its introspection if rclpy has it: from Kilted on."""
        self.do_serve(name)
        can_introspect = hasattr(self.servers[-1], "configure_introspection")
        if introspected and can_introspect:
            self.introspect(self.servers[-1])
        return {"introspected": introspected and can_introspect}

    def do_act_no_more(self, seconds=15):
        """Destroy the last action server."""
        self.servers.pop().destroy()
        return {}

    def do_orders(self, seconds=15):
        """Return the orders of all goals that were requested of the last action server."""
        return {"orders": self.orders}

    def do_serve_bool(self, name, introspected=True, seconds=15, **qos):
        """Serve a SetBool that repeats its argument, with introspection; a client is there too."""
        cls = find_type("std_srvs/srv/SetBool")

        def answer(request, response):
            response.success, response.message = request.data, "on" if request.data else "off"
            return response

        self.services[name] = self.node.create_service(cls, name, answer)
        if introspected:
            self.introspect(self.services[name], **qos)
        self.clients_of[name] = self.node.create_client(cls, name)
        return {}

    def do_flip(self, name, seconds=15):
        """Call a service of do_serve_bool."""
        client = self.clients_of[name]
        request = find_type("std_srvs/srv/SetBool").Request(data=True)
        self.wait(seconds, client.call_async(request).done)
        return {}


if __name__ == "__main__":
    rclpy.init()
    try:
        VerbsPeer().run()
    finally:
        rclpy.shutdown()
