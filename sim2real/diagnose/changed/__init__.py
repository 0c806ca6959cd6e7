"""What has changed in a servo since its reference recordings?"""
